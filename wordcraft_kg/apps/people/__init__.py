"""People at the task: play in a terminal, and studies with the paper's protocol in the browser."""
