"""Knowledge from outside the recipe book, as tables over pairs of entities and as triples.

``folder`` first: a knowledge folder holds tables from a language model or from a general graph such as WordNet.
"""
