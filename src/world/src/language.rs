//! Words: lemmas, the committed vocabulary of synonyms and hypernyms, and whether a text fits an object.
