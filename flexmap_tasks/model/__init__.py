"""The nouns: frozen values made of arrays."""
