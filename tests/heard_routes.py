"""What the tests of the route table share: a table and the time, in short words."""

from gcs_coloc.links.routes import RouteTable

LINK = "the link"
HERE, THERE = ("10.0.0.1", 14550), ("10.0.0.2", 14550)


class Ears:
    """A route table and the time, in short words."""

    def __init__(self, **settings):
        self.table = RouteTable(**settings)
        self.now_s = 100.0

    def hears(self, sysid, address, compid=1, autopilot=True, link=LINK, other=False):
        return self.table.learn(
            sysid, compid, link, address, is_autopilot_heartbeat=autopilot, is_other_heartbeat=other, now_s=self.now_s
        )

    def route(self, sysid):
        return self.table.route(sysid, self.now_s)
