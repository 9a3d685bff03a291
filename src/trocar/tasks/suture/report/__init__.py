"""What reports show of suture plans and of driven sutures."""
