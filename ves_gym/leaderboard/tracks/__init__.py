"""The tracks of the leaderboard: how each is answered, replayed and answered again."""
