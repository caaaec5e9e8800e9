"""What the data can tell: Fisher information and the Cramér-Rao bound, structure, profile likelihoods."""
