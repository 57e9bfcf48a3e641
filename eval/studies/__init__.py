"""Studies: a question each, answered by one command with a page, a Markdown file and a CSV."""
