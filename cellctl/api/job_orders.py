"""Job orders: what the MES asks for."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Response

from cellctl.api.auth import Allow, Role
from cellctl.api.problems import ProblemError, Violation
from cellctl.api.schemas import JobOrder, JobOrderRequest, JobOrders, Serials
from cellctl.api.services import Services, services_of
from cellctl.api.strict import StrictRoute
from cellctl.orders import Order, OrderRefused, OrderState, Wanted

router = APIRouter(route_class=StrictRoute, tags=["job orders"])
STATUS = {"cell_not_idle": 409, "job_order_exists": 409}


@router.post("/job-orders", status_code=201, dependencies=[Depends(Allow(Role.MES, Role.OPERATOR))])
async def submit(
    asked: JobOrderRequest,
    response: Response,
    services: Annotated[Services, Depends(services_of)],
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=200, description="same key and body: same answer, one run")
    ] = None,
) -> JobOrder:
    """Take an order and start its run: the recipe is checked, tried on a private twin, then the cell begins."""
    serials = asked.serials
    wanted = Wanted(asked.job_order_id, asked.recipe, asked.recipe_version, serials.rotor, serials.shaft)
    try:
        order, again = await services.orders.submit(wanted, idempotency_key)
    except OrderRefused as refused:
        violations = [
            Violation(pointer=fault.pointer, reason=fault.reason, limit=fault.limit or None, unit=fault.unit or None)
            for fault in refused.faults
        ]
        status = STATUS.get(refused.code, 422)
        raise ProblemError(status, refused.code, str(refused), violations=violations) from None
    response.headers["Location"] = f"/api/v1/job-orders/{order.wanted.job_order_id}"
    if again:
        response.headers["Idempotency-Replayed"] = "true"
    return _told(order, "Running")


@router.get("/job-orders", dependencies=[Depends(Allow(Role.VIEWER))])
async def all_orders(
    services: Annotated[Services, Depends(services_of)],
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
    cursor: Annotated[str | None, Query(max_length=64)] = None,
) -> JobOrders:
    """Orders, newest first."""
    orders = services.orders.all()
    ids = [order.wanted.job_order_id for order in orders]
    if cursor is not None and cursor not in ids:
        raise ProblemError(422, "invalid_request", "the cursor names no order")
    start = ids.index(cursor) + 1 if cursor is not None else 0
    page = orders[start : start + limit]
    more = start + limit < len(orders)
    items = [_told(order, services.orders.state(order)) for order in page]
    return JobOrders(items=items, cursor=items[-1].job_order_id if more else None)


@router.get("/job-orders/{job_order_id}", dependencies=[Depends(Allow(Role.VIEWER))])
async def one_order(job_order_id: str, services: Annotated[Services, Depends(services_of)]) -> JobOrder:
    """One order and where it stands."""
    order = services.orders.get(job_order_id)
    if order is None:
        raise ProblemError(404, "job_order_unknown", "no job order of that id")
    return _told(order, services.orders.state(order))


def _told(order: Order, state: OrderState) -> JobOrder:
    wanted = order.wanted
    return JobOrder(
        job_order_id=wanted.job_order_id,
        state=state,
        run_id=order.run_id,
        recipe=wanted.recipe,
        recipe_version=wanted.recipe_version,
        serials=Serials(rotor=wanted.rotor_serial, shaft=wanted.shaft_serial),
        received=datetime.fromisoformat(order.received_utc),
    )
