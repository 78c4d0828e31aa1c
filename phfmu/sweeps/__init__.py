"""Many runs of one model: what varies, what is measured of each, and the table of both."""
