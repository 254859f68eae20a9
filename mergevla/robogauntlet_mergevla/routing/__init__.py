"""Task inference: choosing an expert of a merged model from the first observation of an episode."""
