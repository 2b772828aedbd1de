"""A world, a vehicle and a camera to fly without a drone."""
