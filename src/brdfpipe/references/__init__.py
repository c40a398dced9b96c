"""Reference solutions: rays and waves on the height map itself, which share none of the models' assumptions."""
