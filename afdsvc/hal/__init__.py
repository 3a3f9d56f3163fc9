"""The rig's side: agent, control loop, burst player, simulator, replay and hardware under one contract."""
