"""What the tests of the gallery's page know of the gallery that they open."""

HOSTILE = "<img src=x onerror=\"document.body.dataset.broken='yes'\"><script>alert(1)</script>\u00e9 'mine'"
IMAGES = 150
