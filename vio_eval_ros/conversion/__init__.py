"""Trajectories written in the formats of others, and changed on the way."""
