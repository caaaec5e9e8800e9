"""Child processes: started without the program of their parent, watched, limited, and ended."""
