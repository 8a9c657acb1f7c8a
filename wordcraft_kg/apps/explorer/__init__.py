"""The same as in reports, in the browser: pages of a graph, its models and its agents; and people's studies."""
