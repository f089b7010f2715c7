"""Words that every other room speaks: messages, protocols, frames of reference, errors.

Imports only the standard library, numpy and msgspec.
"""
