"""Reports: self-contained HTML pages, made from run folders alone, and pictures of traces."""
