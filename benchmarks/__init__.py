"""Benchmarks of speed, memory and loss."""
