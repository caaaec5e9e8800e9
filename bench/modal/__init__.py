"""Modal identification from free decays, blows and frequency responses: likelihood, Cramér-Rao bound, modal track."""
