from .stage import by_hand as by_hand
