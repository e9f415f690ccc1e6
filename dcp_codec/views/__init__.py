"""Views of a plan: decoder, encoder, dissector, JSON, text, and checks of single messages."""
