"""The stage certify: a statistical bound of a network's error, an adversary's, and loops that only the guard keeps."""
