"""A world, a vehicle and a camera to fly without a drone.  May import follow's seams and messages, and racf's boxes."""
