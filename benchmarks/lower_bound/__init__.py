"""How little E_mean can be: a bound that no motion goes below, with its proof in README.md."""
