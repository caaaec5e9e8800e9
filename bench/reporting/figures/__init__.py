"""The pictures: one module an idea, one style for all, drawn from stored rows and arrays alone."""
