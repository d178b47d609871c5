"""The walk that stands and steps on true soles; not in the paper of Urban and Adorno."""
