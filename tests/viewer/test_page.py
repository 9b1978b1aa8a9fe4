"""Names are text, wherever in the page they stand."""

from __future__ import annotations

import html
import json
import re

from pm3dof_pin.viewer.page import page_html

NAME = "<!--<script>alert(1)</script>--> & \u2028 \" ' $page ]]>"


def test_a_name_neither_opens_nor_closes_anything() -> None:
    plain = page_html({"name": "arm"}, title="arm", served=False)
    page = page_html({"name": NAME}, title=NAME, served=False)
    for sign in ("<script", "</script", "<!--", "-->"):
        assert page.count(sign) == plain.count(sign), sign
    (data,) = re.findall(r'<script id="scene" type="application/json">(.*?)</script>', page)
    assert json.loads(data) == {"name": NAME}
    (title,) = re.findall(r"<title>(.*?)</title>", page)
    assert html.unescape(title) == NAME
