"""Requirements on methods and systems, as checks with a remedy each; the project's own are held to them."""
