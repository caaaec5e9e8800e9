"""Identification on the lines of the discrete Fourier transform (DFT)."""
