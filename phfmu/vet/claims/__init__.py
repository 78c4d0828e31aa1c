"""Claims that vetting tries, by what they are about; all of them in order."""
