"""Literal frames of every message: worked out by bit position and an independent CRC, not by the code under test."""

from __future__ import annotations

FRAMES: dict[str, tuple[int, str, dict[str, float]]] = {
    "RC_Heartbeat": (
        0x0CFF10B0,
        "05 23 07 ED 01 34 12 00",
        {"Counter": 3, "Mode": 2, "State": 7, "Flags": 0x01ED, "CycleId": 0x1234},
    ),
    "RC_Command": (
        0x0CFF11B0,
        "04 4E 2A 7D 00 00 00 00",
        {"Counter": 14, "Cmd": 4, "CmdSeq": 42, "Arg": 125},
    ),
    "RC_DockPos": (
        0x10FF12B0,
        "8D 73 77 3F DE F7 2D 33",
        {"Counter": 3, "PosSeq": 7, "X": 812.35, "Y": -104.10, "Z": 655.05},
    ),
    "RC_DockRot": (
        0x10FF13B0,
        "D0 73 39 30 DF B1 01 00",
        {"Counter": 3, "RotSeq": 7, "RX": 1.2345, "RY": -2.0001, "RZ": 0.0001},
    ),
    "RC_DockQuality": (
        0x10FF14B0,
        "6B 73 11 1F C0 17 BB 32",
        {
            "Counter": 3,
            "QualSeq": 7,
            "Valid": 1,
            "Frame": 0,
            "Method": 1,
            "RMSE": 0.155,
            "Age": 380,
            "Fitness": 93.5,
            "Tolerance": 1.0,
        },
    ),
    "CH_Status": (
        0x0CFF2056,
        "F2 60 92 0A 2A 02 00 00",
        {
            "Counter": 0,
            "State": 6,
            "PlugLock": 2,
            "Prox": 2,
            "Pilot": 2,
            "ContactorClosed": 1,
            "DockEnable": 0,
            "MotionInhibit": 1,
            "EStop": 0,
            "AckSeq": 42,
            "AckResult": 2,
            "FaultCode": 0,
        },
    ),
    "CH_Electrical": (
        0x18FF2156,
        "3E 09 D0 0F 83 FF 55 7D",
        {"Counter": 9, "Voltage": 404.8, "Current": -12.5, "TempDC": 35, "SoC": 62.5},
    ),
}
