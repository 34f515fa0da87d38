"""What an episode begins with, what is rewarded in it, and when it ends: one task for each kind of environment."""
