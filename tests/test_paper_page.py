"""docs/paper.md tells what the committed reports tell."""

from __future__ import annotations

from docs.make.paper import PAGE, page_with_tables, read_reports


def block(page: str, name: str) -> list[str]:
    return page.split(f"<!-- table {name} -->")[1].split("<!-- end -->")[0].splitlines()


def test_the_page_has_the_numbers_of_the_reports():
    page = PAGE.read_text(encoding="utf-8")
    assert page.count("<!-- table ") == page.count("<!-- end -->") == 5
    assert page_with_tables(page, read_reports()) == page, "run python -m docs.make.paper"


def test_a_number_of_a_report_stands_in_its_row():
    """Peaks of HRP-5P by hand: the paper's left leg first, 17.1 N m of hip yaw."""
    gait = {
        "joints": [
            {"joint": f"{side}{name}", "peak_torque_nm": 10.0 * k, "peak_speed_rad_s": k + 0.25}
            for side, extra in (("L", 1), ("R", 2))
            for k, name in enumerate(("CY", "CR", "CP", "KP", "AP", "AR"), start=extra)
        ],
        "force_peak": [1.5, 1.25],
        "contact_agreement": 0.975,
        "walks": 16,
        "falls": 1,
    }
    stairs = [
        {
            "way": way,
            "rise_m": 0.1,
            "noise_kind": "tread",
            "noise": 0.03,
            "success": success,
            "episodes": 40,
        }
        for way, success in (("up", 1.0), ("down", 0.975))
    ]
    mode = {"mode": "in_place", "falls": 2, "episodes": 50, "landings": 9}
    modes = [{**mode, "error_m_median": 0.0041, "error_m_p95": 0.0123}]
    page = page_with_tables(
        "".join(
            f"<!-- table {name} -->\n<!-- end -->" for name in ("peaks", "gait", "stairs", "modes")
        ),
        {"hrp5p": {"gait": gait, "stairs": stairs, "modes": modes}},
    )
    assert "| hip yaw | 17.1 / 24.1 | 10 / 20 | 0.37 / 1.18 | 1.25 / 2.25 |" in block(page, "peaks")
    assert "| knee | 76.3 / 39.8 | 40 / 50 | 2 / 1.51 | 4.25 / 5.25 |" in block(page, "peaks")
    # 1000 N under 103 kg are 0.99 weights.
    expected = "| vertical force under a foot, peak | 0.99 weights, HRP-5P | 1.50 weights |"
    assert expected in block(page, "gait")
    assert "| walked straight |  | 15 walks of 10 s |" in block(page, "gait")
    told = block(page, "stairs")
    assert "| treads ±3 cm off | withstood | 100.0 % / 97.5 % of 40 |" in told
    assert "| treads ±4 cm off | falls off | - |" in told
    assert "| in place | 2 of 50; 0.4 / 1.2 cm |" in block(page, "modes")
