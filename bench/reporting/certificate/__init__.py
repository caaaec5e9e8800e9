"""The certificate of a measured record: contents as plain values, pictures, and the page."""
