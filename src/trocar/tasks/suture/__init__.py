"""The suture task: sutures round a circle, each driven along the needle primitive."""
