"""Ways to code ranges that codecs share: quantisation with a bound, sample mappings and groups; images and video."""
