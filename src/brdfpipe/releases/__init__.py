"""Results of one build beside those of another: what changed, by how much, and why."""
