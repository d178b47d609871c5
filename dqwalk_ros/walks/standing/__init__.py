"""The standing walk: statically stable steps on rectangular soles; not in the paper of Urban and Adorno."""
