"""What recordings say: profiles, statistics, who holds what, positions, and conditions on frames."""
