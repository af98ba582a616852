"""Links to pages beside docs/, which are right on a code host, led to where the site has them."""

PAGE_OF = {"../benchmarks/README.md": "benchmarks.md", "../CHANGELOG.md": "changes.md"}


def _redirect(app, name, source):
    for target, page in PAGE_OF.items():
        source[0] = source[0].replace(f"]({target}", f"]({page}")


def setup(app):
    app.connect("source-read", _redirect)
    return {"parallel_read_safe": True}
