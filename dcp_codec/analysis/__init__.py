"""Analysis of recordings: profiles, statistics, holdings of variables, positions, and conditions on frames."""
