"""From the card to the cause: six gates of the desk, each a face of the function that a command calls."""
