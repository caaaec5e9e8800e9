"""What somebody else's method or system must keep, as checks with a remedy each; the project's own are held to them."""
