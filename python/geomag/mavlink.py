"""Fixes as MAVLink 2 messages, for an autopilot: needs pymavlink (extra `mavlink`).

A fix goes out as GLOBAL_POSITION_INT_COV, which carries its covariance, followed by the command MAV_CMD_EXTERNAL_POSITION_ESTIMATE, by which
PX4 and ArduPilot take a position from outside; it carries one standard deviation. Nothing is sent of what is no fix.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from geomag._errors import InvalidInputError
from geomag._geomag import Fix
from geomag._optional import require
from geomag.projection import transform

__all__ = ["Encoder"]

_NAN = float("nan")
#: The command's time is a 32-bit number that wraps here, which keeps tens of microseconds.
WRAP_S = 250.0


class Encoder:
    """Turns fixes in degrees into MAVLink messages, as bytes.

    Parameters
    ----------
    system, component : identity of the sender on the link.
    target_system, target_component : of the autopilot.
    crs : reference system of the map, where that is in metres: positions are turned to degrees by it. The covariance stays along the map's
        axes, which differ from east and north by the convergence of the meridians.

    Examples
    --------
    >>> import numpy as np, geomag
    >>> from geomag.mavlink import Encoder
    >>> Encoder().encode(None)
    b''
    """

    def __init__(
        self,
        *,
        system: int = 1,
        component: int = 191,
        target_system: int = 1,
        target_component: int = 1,
        crs: str | None = None,
    ) -> None:
        for name, value in (("system", system), ("component", component), ("target_system", target_system),
                            ("target_component", target_component)):  # fmt: skip
            if not (isinstance(value, int) and 0 <= value <= 255):
                raise InvalidInputError(f"{name}: needed a whole number 0 to 255, got {value!r}")
        self._dialect: Any = require("pymavlink.dialects.v20.common", "mavlink", "MAVLink messages")
        self._link = self._dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._target = (target_system, target_component)
        self._crs = crs

    def encode(self, fix: Fix | None, time_s: float | None = None) -> bytes:
        """Messages of one fix; nothing for what may not be used.

        `time_s` is the time of its newest sample in seconds (of the day, or since any start), as the receiver's clock has it.

        Raises `InvalidInputError` for a position that is no longitude and latitude.
        """
        if fix is None or not fix.ok:
            return b""
        x, y = fix.x, fix.y
        if self._crs is not None:
            x, y = (float(c[0]) for c in transform([x], [y], self._crs, "EPSG:4326"))
        longitude, latitude = (x + 180.0) % 360.0 - 180.0, y
        if not (abs(latitude) <= 90.0 and math.isfinite(longitude)):
            raise InvalidInputError(
                f"fix: needed degrees of longitude and latitude, got x {fix.x:g}, y {fix.y:g} (a map in metres?)"
            )
        seconds = 0.0 if time_s is None else float(time_s)
        m = self._dialect
        lat_e7, lon_e7 = round(1e7 * latitude), round(1e7 * longitude)
        covariance = [_NAN] * 36
        spread = _NAN
        if fix.covariance_m2 is not None:
            c = np.asarray(fix.covariance_m2, dtype=np.float64)
            # Rows and columns are x (north), y (east), z and the velocities of the same.
            covariance[0], covariance[1], covariance[6], covariance[7] = c[1, 1], c[0, 1], c[0, 1], c[0, 0]
            spread = math.sqrt(0.5 * float(np.trace(c)))
        position = m.MAVLink_global_position_int_cov_message(
            max(0, round(1e6 * seconds)),
            m.MAV_ESTIMATOR_TYPE_UNKNOWN,
            lat_e7,
            lon_e7,
            0,
            0,
            _NAN,
            _NAN,
            _NAN,
            covariance,
        )
        command = m.MAVLink_command_int_message(
            *self._target,
            m.MAV_FRAME_GLOBAL,
            m.MAV_CMD_EXTERNAL_POSITION_ESTIMATE,
            0,
            0,
            seconds % WRAP_S,
            0.0,
            spread,
            0.0,
            lat_e7,
            lon_e7,
            _NAN,
        )
        return b"".join(bytes(message.pack(self._link)) for message in (position, command))
