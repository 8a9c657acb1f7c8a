"""What a server listens with, and what its pages say to browsers."""

import socket

from wordcraft_kg.apps.web.guard import HEADERS
from wordcraft_kg.apps.web.serving import listen


def test_a_page_is_sent_at_once():
    """asyncio sets TCP_NODELAY on connections whose socket names its protocol; without it a page may wait 40 ms."""
    with listen("127.0.0.1", 0) as listening, socket.create_connection(listening.getsockname()):
        connection, _ = listening.accept()
        with connection:
            assert connection.proto == socket.IPPROTO_TCP


def test_forms_of_the_site_itself_name_their_origin():
    """With the policy no-referrer a browser sends "Origin: null", which the guard has to refuse."""
    assert HEADERS["Referrer-Policy"] == "same-origin"
