"""Rigs and reference models that several tests share."""
