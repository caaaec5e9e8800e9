"""Information in the data: Fisher information, Cramér-Rao bound, structural identifiability, profile likelihoods."""
