"""Methods that the report builds on or compares itself with, each as it was published."""
