"""How right it was: the only reader of ground truth."""
