"""Diagnosis of robots: torques, parameters of each joint, controllers, and validation."""
