"""The explorer: a graph, models and agents as pages in the browser, served or exported as a static site.

A page is a state and a view (``page``). A state is a frozen record whose fields are the address, so every choice is a
link. A page names the function that computes the view, which ``format=json`` prints, and the template. The server and
the static site render the same pages and differ only in their addresses. Expensive values (ranks, the map, a
policy bound to tasks) are computed once, by the first page that needs them (``Explored.once``).
"""
