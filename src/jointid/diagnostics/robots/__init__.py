"""What is told of a robot, and what its record leaves open: torques, parameters by joint, the loops as declared."""
