"""Content, resources and links of an HTML page, read without a browser."""

from lxml.html import document_fromstring


class Page:
    """Words outside of scripts, addresses that are loaded, links, and anchors to link to."""

    def __init__(self, text):
        find = document_fromstring(text.encode()).xpath
        self.text = " ".join(" ".join(find("//text()[not(parent::script|parent::style)]")).split())
        sheets = "//link[not(@rel='canonical' or @rel='next' or @rel='prev')]/@href"
        self.loads = find(f"//@src|//@srcset|//@data|//@srcdoc|{sheets}")
        self.links = find("//a/@href")
        self.anchors = {*find("//@id|//@name")}
