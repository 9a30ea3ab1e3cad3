"""Network definitions, one in each file. The code for training and use is outside this package."""
