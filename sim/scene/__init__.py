"""The drawn world: actors, their motion and their surroundings (`world`, `worlds`), and its images (`rendering`).

May import: follow's geometry, racf's boxes.
"""
