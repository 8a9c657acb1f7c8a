"""Labels that are no harm to a book, and might be to a page, an address or a file name."""

HOSTILE = (
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "a/b",
    "..",
    "what?",
    "c#",
    "100 %",
    "%2e%2e",
    "back\\slash",
    "ein 'Apostroph' & ein \"Zitat\"",
    "émoji 🔥",
    "x" * 200,
)
