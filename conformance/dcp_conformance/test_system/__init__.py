"""The test system as a test case sees it: stations, frames, received beacons, services and checks."""
