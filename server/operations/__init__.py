"""What whoever keeps a coordinator running needs: an examination, retention, files to move a campaign by."""
