"""HTML pages, charts and tables from the values in :mod:`wordcraft_kg.evaluation`.

A page is one file that can be read without a script. Headings and explained terms are collected while its template is
rendered; they become the contents table and the glossary. One script sorts, searches and copies tables; the page's
content security policy admits only this script, by its hash, and all resources are in the file.
"""
