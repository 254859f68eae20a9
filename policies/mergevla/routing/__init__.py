"""Task inference: which expert of a merged model the first observation of an episode calls for."""
