"""Result tables: columns with units over time, written, read and handed to other packages."""
