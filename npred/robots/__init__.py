"""Plants of rigid bodies: chains, URDF files, and Pinocchio."""
