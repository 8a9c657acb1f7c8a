"""People at the task: play in a terminal, the paper's protocol with files, and studies in the browser."""
