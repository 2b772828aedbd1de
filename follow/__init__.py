"""The application: a camera's frames in, velocity setpoints to an autopilot out.

`loop` shows the whole data flow on one screen; `messages`, `geometry` and `ranges` are what every room speaks.
Imports run one way: camera, link, control <- safety <- operator, recording <- flight <- cli; `config` gathers the
settings of all rooms for the command line.
"""
