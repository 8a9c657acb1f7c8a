"""People take the paper's protocol in the browser: the pages of a study, and the server that keeps their answers."""
