"""Numbers as they are read: as many digits as the interval supports, a true minus sign, units.

None, which the results hold where a number is not due, is a dash.
"""

import math

MINUS, DASH, THIN = "\N{MINUS SIGN}", "\N{EN DASH}", "\N{NARROW NO-BREAK SPACE}"


def _minus(text: str) -> str:
    return text.replace("-", MINUS)


def _decimals(uncertainty: float | None) -> int:
    """Decimals at which two digits of an uncertainty, in percent, are shown."""
    if uncertainty is None or not uncertainty > 0:
        return 2
    return min(4, max(0, 1 - math.floor(math.log10(uncertainty))))


def percent(value: float | None, *, signed: bool = True, decimals: int = 2) -> str:
    """A relative number in percent: `+0.12 %`."""
    if value is None:
        return DASH
    return _minus(f"{100 * value:{'+' if signed else ''}.{decimals}f}") + f"{THIN}%"


def margin(value: float) -> str:
    """A margin in percent, without zeros that say nothing: `1 %`, `0.5 %`, `2.04 %`."""
    return f"{100 * value:.2f}".rstrip("0").rstrip(".") + f"{THIN}%"


def two_digits(value: float) -> str:
    """The end of a scale, which has two digits: `+7.2 %`, `+170 %`."""
    return percent(value, decimals=_decimals(100 * abs(value)))


def interval(value: float | None, low: float | None, high: float | None) -> str:
    """A relative number and its interval: `+0.12 % [−0.03, +0.27]`."""
    if value is None:
        return DASH
    if low is None or high is None:
        return percent(value)
    decimals = _decimals(50 * (high - low))
    ends = ", ".join(_minus(f"{100 * end:+.{decimals}f}") for end in (low, high))
    return f"{percent(value, decimals=decimals)} [{ends}]"


def plus_minus(value: float | None, low: float | None, high: float | None) -> str:
    """The same where room is short: `+0.12 ± 0.15 %`, the larger half of the interval."""
    if value is None or low is None or high is None:
        return percent(value)
    half = max(high - value, value - low)
    decimals = _decimals(100 * half)
    number = _minus(f"{100 * value:+.{decimals}f}")
    return f"{number}{THIN}±{THIN}{100 * half:.{decimals}f}{THIN}%"


def number(value: float | None, digits: int = 3) -> str:
    """Significant digits: `0.0123`, `4.56 × 10⁻⁷`."""
    if value is None:
        return DASH
    if isinstance(value, int):
        return _minus(f"{value:,}".replace(",", THIN))
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        return _minus(f"{value:.{max(0, digits - 1 - exponent)}f}")
    raised = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return _minus(f"{value / 10.0**exponent:.{digits - 1}f}") + f"{THIN}×{THIN}10{raised}"


def similarity(value: float | None) -> str:
    """SSIM: three decimals, and never a 1 that is not one."""
    if value is None:
        return DASH
    return "> 0.999" if 0.9995 <= value < 1 else _minus(f"{value:.3f}")


def duration(seconds: float | None) -> str:
    """Seconds in the unit that people use: `34 ms`, `0.25 s`, `3.2 s`, `4 min 10 s`, `2 h 5 min`."""
    if seconds is None:
        return DASH
    if seconds < 0.0995:
        return f"{1000 * seconds:.{1 if seconds < 0.00995 else 0}f}{THIN}ms"
    if seconds < 99.5:
        return f"{seconds:.{2 if seconds < 0.995 else 1 if seconds < 9.95 else 0}f}{THIN}s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60}{THIN}min {whole % 60}{THIN}s"
    return f"{whole // 3600}{THIN}h {whole % 3600 // 60}{THIN}min"


def setting(value: object) -> str:
    """A setting of any plain type, as one phrase."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if value is None:
        return DASH
    if isinstance(value, int):
        return number(value)
    if isinstance(value, float):
        return _minus(f"{value:.6g}")
    if isinstance(value, list | tuple):
        return ", ".join(setting(item) for item in value)
    if isinstance(value, dict):
        return "; ".join(f"{name}: {setting(item)}" for name, item in value.items())
    return str(value)
