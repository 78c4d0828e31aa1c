/* The sources of a unit have this file with all names that a linker sees changed to those of the model, so
 * that units of several models can be linked into one program. */
