"""Garbage and mutations into everything that reads from outside."""
