"""People at the task: play in a terminal, the paper's protocol and its files, and studies in the browser."""
