"""Bad input by the thousand: lines for every command, files that are cut, altered and swapped, constructors."""
