"""A Universal Robots e-Series controller at protocol level, in a process and on a loopback address of its own.

``python -m mocks.ur --host 127.0.0.2`` offers RTDE (30004), the dashboard (29999), the script port (30003) and the
primary and secondary ports (30001, 30002) until SIGTERM; the real client library cannot tell. In a run folder
(``--world``) the arm carries a plug in the mock world: it publishes its flange pose and meets the port as
``mocks.world.contact`` says. Faults come as JSON lines on standard input (``--control``, see ``control_channel``).

What it does not simulate: dynamics, currents, temperatures and calibration; self-collision and joint torques; blends
and circular paths (the arm stops at way-points); URScript beyond plain calls (ur_rtde's own control script is
emulated by command number); .urp programs; tool and field-bus communication; the real-time stream of port 30003; the
peculiarities of CB3 and PolyScope X; how long power-on and brake release really take. Timing is that of a Python
process: samples are spaced exactly in emulated time, not on the wall clock. An RTDE input written twice within one
controller cycle is seen both times, where a real controller may see only the last.
"""
