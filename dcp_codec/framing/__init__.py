"""Link-layer frames: where the bearer payload is, how frames are built, and EtherTypes."""
