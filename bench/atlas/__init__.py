"""The atlas: accuracy of methods, and its bound, over the range of possible vibration tests of an oscillator."""
