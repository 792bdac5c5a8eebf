"""Pages of results as HTML and Markdown: report, page of a study, web pages of a leaderboard."""
