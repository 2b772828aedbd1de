"""Rigs and referees that several tests share."""
