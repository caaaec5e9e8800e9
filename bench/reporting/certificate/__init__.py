"""The certificate of a measured record: plain contents, pictures, and the page that holds them."""
