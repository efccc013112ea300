"""The leaderboard: entries that anybody can check, their statistics and their page."""
