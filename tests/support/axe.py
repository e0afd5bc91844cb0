"""What axe, which Lighthouse asks too, finds on a page that keeps people from reading or using it."""

from importlib.resources import files

ELSEWHERE = (
    "landmark-unique",  # the theme has each menu twice, one of them for phones
    "scrollable-region-focusable",  # the theme lets keys scroll code where a pointer can hover, as none can here
)

FAULTS = """
const [rules, done] = arguments;
const reason = (node) => [...node.any, ...node.all, ...node.none].map((check) => check.message).join("; ");
const found = ({ id, nodes }) => nodes.map((node) => [id, node.html.slice(0, 200), reason(node)]);
axe.run({ resultTypes: ["violations"], rules }).then(({ violations }) => done(violations.flatMap(found)));
"""


def faults(driver):
    """Return what is wrong with the page that is open, as rule, element and reason."""
    driver.execute_script((files("axe_core_python") / "axe.min.js").read_text())
    driver.set_script_timeout(60)
    return driver.execute_async_script(FAULTS, {rule: {"enabled": False} for rule in ELSEWHERE})
