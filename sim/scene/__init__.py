"""The drawn world: who is in it and how they move (`world`, `worlds`), and what a camera sees of it (`rendering`).

May import: follow's geometry, racf's boxes.
"""
