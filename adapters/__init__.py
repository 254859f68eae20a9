"""Where policies act: one module per simulator behind one contract."""
