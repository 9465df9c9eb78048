"""How long the stages of a film are."""

N_DECISIONS = 20
"""How many decisions a stage of a film has, if nobody says otherwise."""
