"""The commands of `muslin`: each a class whose fields are its options, and which does it when called."""
