"""What a page of HTML says, loads and leads to, read without a browser."""

from html.parser import HTMLParser

LOADS = ("src", "srcset", "data", "srcdoc")


class Page(HTMLParser):
    """Words outside of scripts, addresses that are loaded, links, and anchors to link to."""

    def __init__(self, text):
        super().__init__()
        self.words: list[str] = []
        self.loads: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self._silent = False
        self.feed(text)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        given = {key: value or "" for key, value in attrs}
        self._silent = tag in ("script", "style")
        self.anchors |= {given[key] for key in ("id", "name") if key in given}
        self.loads += [given[key] for key in LOADS if key in given]
        if tag == "link" and given.get("rel") not in ("canonical", "next", "prev"):
            self.loads.append(given["href"])
        elif "href" in given and tag == "a":
            self.links.append(given["href"])

    def handle_endtag(self, tag):
        self._silent = False

    def handle_data(self, data):
        if not self._silent:
            self.words.append(data)
