"""Data sets to train on: the pictures of a run with what is wanted of their truth, as files or one after the other.

``sample`` reads one item as arrays; ``splits`` says to which split and shard it belongs; ``shards`` writes a run as
WebDataset, Parquet or HDF5 with its card; ``symmetry`` crops, mirrors and turns samples; ``samples`` is the sequence
that training loops read.
"""
