"""The step follower: what it sees, what it does, how it is rewarded, trained and run."""
