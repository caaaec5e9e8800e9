"""What a method sees and answers: problem, prior, estimate, and the class to subclass. No simulation here."""
