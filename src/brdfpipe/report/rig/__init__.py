"""The part of a material's page about its measurement on a camera rig."""
