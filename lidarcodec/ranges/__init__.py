"""Ways to code ranges that codecs share: steps with a bound, tables, groups; images and video have folders."""
