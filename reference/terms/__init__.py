"""One file per summand of `L_o = L_ambient + L_direct + L_specular + L_background`, each for any Limit of it."""
