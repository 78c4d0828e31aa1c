"""Names of what inputs are between rows of data; without imports, for the command line."""

#: word -> what it means
INTERPOLATIONS = {
    "held": "each row until the next one",
    "linear": "straight lines between rows",
    "cubic": "a smooth curve through the rows",
}
