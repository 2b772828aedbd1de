"""Fuzzing: random and mutated input for everything that reads data from outside."""
