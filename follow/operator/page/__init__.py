"""The operator's page: the image, the states and the orders in a browser, on a desktop or a phone.

The control loop hands its newest frame and status to `exchange`, whose other side is the page's own thread (`server`).
`desk` is the loop's side, `door` checks each request, `recordings` serves the folders of flights.
"""
