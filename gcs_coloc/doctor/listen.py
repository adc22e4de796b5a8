"""Listening of the doctor: open the links, pass what arrives to the survey, send its requests."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import replace

from gcs_coloc.config.settings import Settings
from gcs_coloc.core.engine import Engine
from gcs_coloc.core.messages.control import ClockReference
from gcs_coloc.core.stations.stations import Stations
from gcs_coloc.doctor.finding import FleetSurvey
from gcs_coloc.doctor.survey import Question, Survey
from gcs_coloc.estimators.registry import load_estimator
from gcs_coloc.links.base import Address, Link, Route, parse
from gcs_coloc.links.signed_links import SignedLinks
from gcs_coloc.mavlink.encoder import Encoder
from gcs_coloc.mavlink.framing import GCS_COMPID, GCS_SYSID
from gcs_coloc.mavlink.signing import Stamp
from gcs_coloc.runtime.clock import ServiceClock

_ASK_EVERY_S = 0.1  # chosen: ten questions a second fill no telemetry radio
_HEARTBEAT_EVERY_S = 1.0  # source: MAVLink's heartbeat protocol


async def listen(
    settings: Settings, seconds: float, clock: ServiceClock, host: ClockReference, opened: Callable[[], None]
) -> FleetSurvey:
    """Listen on the links of `settings` for `seconds`, and send the survey's requests meanwhile.

    `opened` is called once the links are open.

    Raises:
        LinkError: a link cannot be opened.
        ConfigError: the signing key is of no use.
        EstimatorError: the estimator of the settings cannot be made.
    """
    ids = settings.mavlink
    signed = SignedLinks(settings.signing, settings.links)
    signed.set_clock(host.utc_minus_service_s)
    start_s = clock()
    engine = Engine(load_estimator(settings.estimator.name, settings.estimator.settings), settings.engine())
    engine.receive(host)
    survey = Survey(
        (ids.system_id, ids.component_id),
        start_s,
        seconds,
        utc_minus_service_s=host.utc_minus_service_s,
        asks_for_streams=settings.fleet.request_streams,
        stations=Stations(settings.engine().stations, settings.measurements.ranging_beacon_ids),
        engine=engine,
    )
    ours, as_gcs = Encoder(sysid=ids.system_id, compid=ids.component_id), Encoder(sysid=GCS_SYSID, compid=GCS_COMPID)
    names: dict[Hashable, str] = {}

    def arrived(link: Link, address: Address, payload: bytes, at_s: float) -> None:
        route = Route(link, address)
        names[route] = str(route)
        survey.receive(payload, route, at_s, signed.of(link.name))

    def stamp(link: Link) -> Stamp | None:
        signing = signed.of(link.name)
        return signing.stamp(clock()) if signing is not None else None

    def send_request(question: Question) -> None:
        place, encoder = question.place, as_gcs if question.as_gcs else ours
        assert isinstance(place, Route)
        place.link.send(place.address, encoder.encode(question.message, place, stamp(place.link)))

    links = [parse(text).make_link(arrived, clock) for text in settings.links]
    try:
        for link in links:
            await link.open()
        opened()
        greet_at_s = start_s
        while (now_s := clock()) < start_s + seconds:
            if now_s >= greet_at_s:
                greet_at_s = now_s + _HEARTBEAT_EVERY_S
                # Some vehicles speak to nobody before they have heard a heartbeat.
                for place in {*names, *(Route(link, peer) for link in links for peer in link.peers)}:
                    assert isinstance(place, Route)
                    place.link.send(place.address, ours.heartbeat(place, stamp(place.link)))
            for question in survey.questions(now_s):
                send_request(question)
            await asyncio.sleep(_ASK_EVERY_S)
    finally:
        for link in links:
            await link.close()
    heard = survey.findings(names, host_is_synchronised=host.synchronised)
    # What a stream brings is cut into frames by its link, which counts what is none.
    return replace(heard, refused=sum((Counter(link.counts) for link in links), Counter(heard.refused)))
