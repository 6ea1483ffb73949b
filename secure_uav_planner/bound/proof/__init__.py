"""What must be right: from any multipliers to a bound, with nothing taken on trust."""
