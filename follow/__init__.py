"""The application: a camera's frames in, velocity setpoints to an autopilot out."""
