"""What is wrong, as people are told of it: alarms with a life, texts for ground tools, each vehicle's traffic light."""
