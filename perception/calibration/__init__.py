"""Where the scanner and the plug sit on the flange, from what the robot can measure itself; how good that is; drift."""
