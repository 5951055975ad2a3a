"""`estimate`: parameters by maximum evidence, with standard errors, profiles and rivals."""
