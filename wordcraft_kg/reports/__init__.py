"""HTML pages, charts and tables from the evaluation results in :mod:`wordcraft_kg.evaluation`.

A page is a single file that can be read without a script. Headings and explained terms are collected while the page
template is rendered, and become the contents table and the glossary. A script sorts, searches and copies tables; the
page's content security policy admits only this script, by hash, and all resources are in the file.
"""
